"""Triggers evaluate programs as simulated time passes, and call back when results change.

`registry` holds the triggers of an interpreter, and `trigger` is one of them. `conditions` decides
when it fires, `diff` compares results, and `callback_queue` runs callbacks in their own thread.
"""
