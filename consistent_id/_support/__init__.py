"""Arrays, files, tables, threads, progress and interrupts, for every room."""
