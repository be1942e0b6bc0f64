"""Proofs that decide many pairs of shapes at once, with room for rounding errors.

`gjk` bounds the distances of convex `cores`. For a few pairs, `proposals` of FCL bound them.
`separating_axes` bounds the overlaps of boxes. `contact_directions` bounds the overlaps in all
directions, for the contact normal. `footprints` bounds what is below an entity. What they leave
undecided is compared pair by pair. `verdicts` are kept while shapes hardly move.
"""
