"""``python -m chromaperture``: the command line."""

from chromaperture.cli.main import main

if __name__ == "__main__":
    main()
