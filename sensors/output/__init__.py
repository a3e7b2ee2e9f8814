"""Writers of simulated data: data sets in public layouts, toolkit scenes, recordings.

Every writer is a context manager. `add` accepts frames in any order; the output appears when all
frames were added and the block ends without an error.
"""
