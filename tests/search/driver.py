"""Runs several command lines in one process, as the start of the program takes longer than a small search.

Reads a JSON list of lists of arguments; after each, one line "exit code <n>" follows what it printed.
"""

import json
import sys
import traceback

from pgdl_lab.cli import main

for arguments in json.load(sys.stdin):
    sys.argv = ["pgdl-lab", *arguments]
    code: object = 0
    try:
        main()
    except SystemExit as stop:
        code = stop.code
        if isinstance(code, str):
            print(code)
            code = 1
    except BaseException:
        traceback.print_exc()
        code = 1
    print(f"exit code {code or 0}", flush=True)
