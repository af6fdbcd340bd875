"""``python -m service``: the command ``ambit``, wherever its script is."""

from service.cli import main

if __name__ == "__main__":
    main()
