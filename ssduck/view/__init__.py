"""A page in the browser that shows a world in 3-D, and answers what is typed: `ssduck view`."""
