"""The page of a file: one HTML document with the file's contents and the cost of its symbols."""
