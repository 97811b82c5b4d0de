"""From a dataset's files back to arrays, as a stranger reads them: nothing here uses the code that wrote them."""
