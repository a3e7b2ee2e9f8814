"""Reading recordings of other formats into scenes."""
