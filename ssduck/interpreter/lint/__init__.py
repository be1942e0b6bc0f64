"""Probable mistakes in programs and raw SQL: what is valid, but hardly intended.

`linter` finds checks once in each statement, by the other modules, and makes them before each run:
what they tell depends on the variables, functions and worlds of a `scope`.
"""
