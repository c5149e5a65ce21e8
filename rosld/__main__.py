"""`python -m rosld` is `rosld`."""

from rosld.server.cli.main import main

if __name__ == "__main__":
    main(prog_name="rosld")
