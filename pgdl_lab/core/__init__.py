"""What all rooms stand on: errors, files, paths, the registry of plugins, snapshots and splits."""
