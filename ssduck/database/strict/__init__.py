"""Checks SQL under strict limits before it runs: one SELECT, its functions and its size."""
