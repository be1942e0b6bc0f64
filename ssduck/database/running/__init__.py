"""Runs statements of DuckDB: in time, until Ctrl-C, and with ssduck's errors."""
