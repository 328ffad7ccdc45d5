"""Reports of a run: a record in JSON, and made from it alone JUnit XML, a page in HTML and a summary for a terminal."""
