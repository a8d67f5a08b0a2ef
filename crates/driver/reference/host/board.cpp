// The reference sketch as a program of the host, for tests.
#include "../servo_board.ino"

int main() {
  setup();
  for (;;) loop();
}
