"""System 3, connectivity maintenance with cameras [Bernard2023]."""
