"""Stores recorded ticks: in memory, in DuckDB, or in folders of Parquet files."""
