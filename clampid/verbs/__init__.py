"""The verbs of the command line: thin layers over public functions, found through entry points."""
