"""The model that training data ask for, chosen by blocked cross-validation."""
