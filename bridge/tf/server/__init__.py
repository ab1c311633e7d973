"""What is served to other programs from one transform buffer; above the module host, as no other part of frames is."""
