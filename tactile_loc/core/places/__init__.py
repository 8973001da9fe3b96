"""Places of an object that can touch first, and the patches of height around them."""
