"""Translates a query's tree to DuckDB SQL. This package knows no world and no database.

`translator` turns a query into a `plan`, through sqlglot: `expressions` translates what the query
selects and its conditions, `from_clause` its sources. A part that SQL cannot express raises
`NotSqlError`; `ssduck.language` evaluates it. `relations` defines the relations between entities.
"""
