"""The contents of a file for people: elements, dumps, summaries, traces, explanations."""
