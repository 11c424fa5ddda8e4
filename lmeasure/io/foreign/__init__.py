"""Tables of other people: any usual header, separator, decimal mark and code page, and columns under other names in other units."""
