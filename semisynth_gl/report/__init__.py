"""What a dataset holds, as one page: measured from its files, and from its scenes made again."""
