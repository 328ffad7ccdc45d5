"""The registry of implementations: their reports, audited, and from these a page and badges."""
