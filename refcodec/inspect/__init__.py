"""What a file is made of, for people: elements, dumps, summaries, traces, explanations."""
