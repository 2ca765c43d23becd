"""Robots of one type, identified together: their bodies are shared."""
