"""Reports of a run: the record (JSON), JUnit XML, a page (HTML) and a summary for a terminal; each is made from the record alone."""
