"""The command line: it parses words, calls a function of `refcodec.api` and prints the result."""
