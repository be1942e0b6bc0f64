"""Where recorded ticks are kept: in memory, in DuckDB, or in folders of Parquet files."""
