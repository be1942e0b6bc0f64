"""Lets agents ask a scene or a record, over the Model Context Protocol."""
