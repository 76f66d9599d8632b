"""Banks of data with hidden effects on which diagnoses are judged: made by hidden_effects, diagnosed, scored."""
