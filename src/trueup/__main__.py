"""`python -m trueup`: the command, where its script is not on the path."""

from trueup.cli.main import main

if __name__ == "__main__":
    main()
