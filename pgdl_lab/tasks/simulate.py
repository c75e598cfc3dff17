"""Task `simulate`: only the snapshots."""
