"""The one door to DuckDB: connections, schemas, prepared statements.

A `Database` has a schema for each world (`worlds`, `schemas`), with a view of each table and a
macro for each relation (`macros`). A statement runs on one tick (`plans`, `connection`).
`functions` are the Python functions that SQL calls; `values` converts values to SQL and back.
"""
