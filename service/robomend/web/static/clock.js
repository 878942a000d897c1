// Time that has passed, whatever is done to this computer's clock: it may be set, and it may be minutes off.
const JUMP_MS = 1000;

let passed = 0;
let evenMs = performance.now();
let clockMs = Date.now();

/** Return the milliseconds since the page was loaded. They never go back; while the computer sleeps they pass. */
export function passedMs() {
  const even = performance.now() - evenMs; // stands still while the computer sleeps
  const clock = Date.now() - clockMs;
  evenMs += even;
  clockMs += clock;
  passed += clock > even + JUMP_MS ? clock : even; // rather too old than too young
  return passed;
}
