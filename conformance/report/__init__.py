"""Reports of a run: a record in JSON, and from it an HTML page and a summary for a terminal."""
