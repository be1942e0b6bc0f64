"""Temporal logic over the ticks of an episode: whether conditions hold, and by how much.

`traces` has the operators on the values at all ticks, `margins` turns a condition into the
expression of its margin.
"""
