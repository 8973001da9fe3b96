"""A local page on which people press a virtual finger on an object, add touches, and locate the object from them."""
