"""Results that are kept on disk and found again."""
