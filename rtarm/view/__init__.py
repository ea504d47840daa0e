"""`rtarm view`: a page on which a browser shows an arm, what it does and why it stopped, and from which it is moved.

The page runs in a process of its own that only reads the arm's mapped files; what it asks for goes the way of every
other request. `page` puts it together from `scene` (what stands in space), `panels` and `plots` (what stands beside
it), `source` (what there is to be seen: a running arm or a recording) and `orders` (what the buttons do).
"""
