"""Expressions as functions: of Python's numbers for one instance, of arrays for many at once.

An expression is SQL, as the translator and the formulas of relations have it. `compiler` makes a
function of it, from the operations of `numbers`, for one row, or of `arrays`, for all rows of a
table and all constants of expressions that differ in these alone. What has more than one right
result, such as an exponential, is left to DuckDB, so that the values are DuckDB's bit for bit.
"""
