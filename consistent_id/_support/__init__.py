"""What every room needs: arrays, files, tables, threads, progress, interrupts."""
