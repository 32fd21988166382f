"""Accuracy of an optical or electromagnetic tracker."""
