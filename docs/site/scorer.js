// Pages before options and names that merely contain the word: who looks for "lux" does not mean --min-flux-fraction.
var Scorer = {
  objNameMatch: 11,
  objPartialMatch: -10,
  objPrio: { 0: 0, 1: 0, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
