"""Results as text, JSON, CSV and HTML: pure functions of a result."""
