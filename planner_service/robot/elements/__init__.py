"""Which elements and attributes robot files may have, and what becomes of each."""
