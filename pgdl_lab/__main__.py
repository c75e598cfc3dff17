"""Entry point of `python -m pgdl_lab` and of the console script `pgdl-lab`."""

from pgdl_lab.cli import main

if __name__ == "__main__":
    main()
