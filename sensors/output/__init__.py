"""What a simulation leaves on disk: data sets in public layouts, toolkit scenes, recordings.

Every writer is a context manager that takes frames by `add`, in any order; what it writes appears
when all of them were added and the block ends without an error.
"""
