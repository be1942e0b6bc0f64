"""Proofs that decide many pairs of shapes at once, with room for rounding errors.

`gjk` bounds the distances of convex `cores`. For a few pairs, `proposals` of FCL bound them by
support functions and `interiors`. `separating_axes` bounds the overlaps of boxes.
`contact_directions` bounds the overlaps in all directions, for the contact normal, by
`direction_triangles`. `footprints` bounds what is below an entity. What they leave undecided is
compared pair by pair. `kept_verdicts` keeps what was decided while shapes hardly move.
"""
