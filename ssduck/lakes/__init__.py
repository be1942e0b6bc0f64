"""Asks many recorded episodes one question, on one machine, on Ray or on Spark.

`Lake` lists the episodes of all records below a path in a `manifest`, which `scan` makes. A
question (`questions`) goes to batches of episodes, on one of the `engines`; each of their processes
answers batches (`workers`).
"""
