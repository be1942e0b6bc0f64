"""Recorded ticks, read: rows, entities, and worlds as they were.

`record` is what is kept of a world, by tick. `restore` makes a tick of its rows, `past_world` a
world. `past` is what a query has in FROM; `batch_queries` compares shapes over many ticks at once.
"""
