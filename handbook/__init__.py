"""The documentation's machinery: the reference pages that are generated, and the tree that the site is made from."""
