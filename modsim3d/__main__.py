"""`python -m modsim3d` is the command line."""

from modsim3d.cli.main import main

if __name__ == "__main__":
    main()
