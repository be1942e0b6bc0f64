"""Functions of time: what an expression was at each recorded tick.

`functions` has them, from a `series` of values; `evaluator` makes the query that has these. Of a
simulation that goes on, `live` keeps what the ticks until now come to, and adds the next one.
"""
