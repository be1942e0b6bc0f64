"""Benchmarks: times of ssduck relative to alternatives without it, measured in one run."""
