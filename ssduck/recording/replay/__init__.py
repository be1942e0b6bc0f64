"""Reads recorded ticks: rows, entities, and worlds as they were.

A `record` provides the recorded ticks of a world. `restore` turns the rows of a tick into a
snapshot and a world at that tick. `past` is a source of queries; `batch_queries` compares shapes at
many ticks at once.
"""
