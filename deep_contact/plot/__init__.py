"""Pictures, films and HTML pages of states and runs."""
