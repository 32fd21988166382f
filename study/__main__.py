"""``python -m study``: the command line, where the command itself is not on the path."""

from study.cli import main

if __name__ == "__main__":
    main()
