"""Model selection: terms and settings chosen by blocked cross-validation."""
