"""One run from its configuration to its tracked result, and many runs at once."""
