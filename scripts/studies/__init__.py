"""The studies of docs/studies, a file or a folder for each, run by study.py."""
