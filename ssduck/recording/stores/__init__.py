"""Where recorded ticks are stored: in memory, in DuckDB, or in folders of Parquet files."""
