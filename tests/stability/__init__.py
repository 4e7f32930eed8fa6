"""Stiff and extreme scenes with known answers.

Every module here that registers cases (`case.py`) joins the suite (`cases.py`).
"""
