"""The live loop and its page in the browser (extra ``viewer``)."""
