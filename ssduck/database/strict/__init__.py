"""Checks SQL under strict limits before it runs: one SELECT, permitted functions, a bounded size."""
