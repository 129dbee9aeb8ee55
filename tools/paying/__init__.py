"""What closing the loop is worth to a policy: four machines that their scenes do not describe."""
