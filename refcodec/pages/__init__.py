"""The template engine, style sheet and plots of the HTML pages."""
