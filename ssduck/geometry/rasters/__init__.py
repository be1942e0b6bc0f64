"""Grids of cells in the plane and in space, and which cells a shape fills."""
