"""The relations, a module a family; `ssduck.udfs` is the registry."""
