"""The page of a file: one HTML document that shows what the file is made of, and what its symbols cost."""
