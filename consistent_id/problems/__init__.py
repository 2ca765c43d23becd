"""The problem file: its tables, the values that they stand for, the study of them."""
