"""The report: a finished dataset as one page, measured from its files and its rebuilt scenes; and the contact sheet."""
