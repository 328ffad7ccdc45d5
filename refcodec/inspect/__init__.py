"""Shows people what a file is made of: elements, dumps, summaries, traces, explanations."""
