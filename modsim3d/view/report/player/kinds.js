// The kinds of moments that can be looked for. Keys, buttons, the list of keys and the legend read this table.

const KINDS = [
  { kind: 'missed', name: 'missed', key: 'm', one: 'missed vessel', legend: 'missed' },
  { kind: 'false', name: 'false positive', key: 'f', one: 'false positive', legend: 'false positive' },
  { kind: 'mislabelled', name: 'wrong class', key: 'l', one: 'wrong class (label)', legend: 'wrong class' },
  { kind: 'bad', name: 'IoU below 0.5', key: 'i', one: 'box with IoU below 0.5', legend: 'IoU below 0.5' },
  { kind: 'off', name: 'off its vessel', key: 'w', one: 'box that is off its vessel', legend: 'off its vessel: line to it' },
  { kind: 'hidden', name: 'occlusion begins', key: 'o', one: 'onset of an occlusion' },
  { kind: 'state', name: 'state changes', key: 's', one: 'change of the performance state' },
  { kind: 'differs', name: 'runs differ', key: 'x', one: 'difference between the runs' },
];

function kindOf(kind) { return KINDS.find((each) => each.kind === kind); }
