// Scores of search results: Sphinx's own, with guides first and records of the work last.
var Scorer = {
  score: ([page, title, anchor, description, score]) => {
    if (/^(tutorials|how-to)\//.test(page)) return score + 10;
    return /^(lab-notes|changelog|decisions)/.test(page) ? score - 20 : score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
