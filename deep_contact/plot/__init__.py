"""Pictures, films and pages of states and runs."""
