"""The command `beltrami`, also as ``python -m beltrami_cli``."""

from beltrami_cli.cli.main import main

if __name__ == "__main__":
    main()
