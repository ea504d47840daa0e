"""Why cycles were late: the kernel's trace events around each late one, its time divided into causes."""
