"""What is asked of the statistics of a study: responses, terms of the model, hypotheses."""
