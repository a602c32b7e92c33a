// Was der Server an einem Feld sagt, auf Deutsch. Er spricht Englisch; hier stehen die Sätze, auf die man an Formularen trifft.
const comma = (number) => number?.replace(/(\d)\.(\d)/g, "$1,$2");
const sentences = [
  [/^must be within (?:the limits )?(\S+) to (\S+?)(?: (\S+))?(?:, is (\S+))?$/, (low, high, unit, is) => `muss von ${comma(low)} bis ${comma(high)}${unit ? `\u00a0${unit}` : ""} sein${is ? `, ist ${comma(is)}` : ""}`],
  [/^must be between (\S+) and (\S+), not (\S+)$/, (low, high, is) => `muss von ${comma(low)} bis ${comma(high)} sein, ist ${comma(is)}`],
  [/^must be above (-?[\d.]+) (\S+)$/, (low, unit) => `muss über ${comma(low)}\u00a0${unit} sein`],
  [/^must be above feed_min_mm_min \((\S+)\), is (\S+)$/, (low, is) => `muss über dem kleinsten Vorschub (${comma(low)}) sein, ist ${comma(is)}`],
  [/^must not be below feed_min_mm_min \((\S+)\)$/, (low) => `darf nicht unter dem kleinsten Vorschub (${comma(low)}) sein`],
  [/^the override range must begin above 0 and contain 100 %$/, () => "der Bereich des Override muss über 0 beginnen und 100\u00a0% enthalten"],
  [/^must not be empty$/, () => "darf nicht leer sein"],
  [/^must have 1 to (\d+) characters$/, (most) => `muss 1 bis ${most} Zeichen haben`],
  [/^must have at most (\d+) (characters|bytes), has (\d+)$/, (most, what, has) => `darf höchstens ${most} ${what === "bytes" ? "Bytes" : "Zeichen"} haben, hat ${has}`],
  [/^must begin with a letter or digit and hold only letters, digits and (.+)$/, (others) => `muss mit einem Buchstaben oder einer Ziffer beginnen; erlaubt sind a bis z, A bis Z, Ziffern und ${others}`],
  [/^must not hold control characters$/, () => "darf keine Steuerzeichen enthalten"],
  [/^must be an RFC 3339 time with an offset/, () => "muss ein Zeitpunkt mit Zeitzone sein, wie 2026-05-04T06:00:00Z"],
  [/^is more than 10 minutes ahead of the server's clock$/, () => "liegt mehr als 10 Minuten vor der Uhr des Servers"],
  [/^(needs|takes) at (?:least|most) (\d+) entries, has (\d+)$/, (which, count, has) => `${which === "needs" ? "braucht mindestens" : "hat Platz für"} ${count} Einträge, hat ${has}`],
  [/^must be deeper than the knot before, by 0\.001 mm at least$/, () => "muss tiefer sein als der Knoten davor, um mindestens 0,001\u00a0mm"],
  [/^must be deeper than where the section begins$/, () => "muss tiefer sein als der Beginn des Abschnitts"],
  [/^the first knot must be at first contact, depth 0$/, () => "der erste Knoten muss am ersten Kontakt sein, Tiefe 0"],
  [/^needs (\S+) mm\/s² from the knot before, the limit is (\S+) mm\/s²: .+$/, (needed, most) => `braucht ${comma(needed)}\u00a0mm/s² vom Knoten davor, die Grenze ist ${comma(most)}\u00a0mm/s²: weiter auseinander, oder weniger Unterschied im Vorschub`],
  [/^must be above from_level$/, () => "muss über dem Beginn des Bereichs sein"],
  [/^the operation is (\S+) mm deep: the last knot must be there$/, (depth) => `die Operation ist ${comma(depth)}\u00a0mm tief: dort muss der letzte Knoten sein`],
];
/** Ein Satz des Servers auf Deutsch; wie er kam, wenn er keiner von diesen ist. */
export function inGerman(message) {
  for (const [sentence, words] of sentences) {
    const found = sentence.exec(message);
    if (found) return words(...found.slice(1));
  }
  return message;
}
