"""A library of parts on disk: each part's surface, its places, and the places' vectors, ready for a search."""
