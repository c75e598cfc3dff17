"""What the command line can do: one module per choice of `task=`, each with a function `run(config, folder, sweep_folder)`."""
