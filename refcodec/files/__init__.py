"""Input and output of the programs: documents from outside, text for a terminal, files and folders."""
