"""A finished dataset as one page, measured from its files and from its rebuilt scenes; the contact sheet."""
