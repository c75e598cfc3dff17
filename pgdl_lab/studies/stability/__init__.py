"""Where methods fail: trials under stress, and how each ended."""
