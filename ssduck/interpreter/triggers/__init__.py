"""Programs that are evaluated as simulated time passes, and callbacks when results change.

`registry` holds the triggers of an interpreter, and `trigger` is one of them. `conditions` decides
when it fires, `diff` finds what changed, and `callback_queue` runs callbacks in their own thread.
"""
