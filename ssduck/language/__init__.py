"""SelectScript: the parser, the tree, and its reference evaluation in Python.

`parser` turns a text into a `tree`. `analysis` finds out what a part of a tree depends on.
`evaluator`, with `operators` and `builtins`, defines the value of an expression; `clauses` and
`hierarchy` define the rows of a query. The translation to SQL is `ssduck.sql`.
"""
