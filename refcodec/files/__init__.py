"""What comes into the programs and goes out of them: documents of others, text for a terminal, files and folders."""
