"""The verbs of the loop: one file, one public function, typed in and typed out."""
