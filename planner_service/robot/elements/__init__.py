"""The elements and attributes that robot files may have, and how each is read."""
