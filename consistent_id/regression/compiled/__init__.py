"""The recursion as straight-line machine code, where a C compiler is at hand."""
