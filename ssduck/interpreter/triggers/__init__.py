"""Programs that are evaluated as simulated time passes, and callbacks for what changes.

`registry` has the triggers of an interpreter. `trigger` is one of them; `conditions` says when it
fires, `diff` what changed, and `callback_queue` calls back in a thread of its own.
"""
