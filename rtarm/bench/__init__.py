"""`rtarm bench`: how late the full cycle wakes up, beside the machine's limit and beside what people use today."""
