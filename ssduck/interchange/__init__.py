"""Brings poses from elsewhere into records, and records into the formats of other tools.

`write_record` writes poses from anywhere as a record.
"""
