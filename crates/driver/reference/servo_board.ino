// A board for heliostat-driver's servo-board protocol: four two-axis mirrors on eight hobby servos, open loop.
// Lines of text at 115200 baud; angles are mechanical, integers in urad, roll before yaw. See crates/driver/src/devices/servo_board.rs.
#include <Servo.h>

const int MIRRORS = 4;
const int AXES = 2 * MIRRORS;
const int PINS[AXES] = {2, 3, 4, 5, 6, 7, 8, 9};
const long MIN_URAD = -523599, MAX_URAD = 523599;  // 30 degrees either way
const long CENTRE_US = 1500, US_PER_RAD = 637;     // 1 ms of pulse turns a servo by 90 degrees
const unsigned long SILENCE_MS = 1000;

Servo servos[AXES];
long angles[AXES];
char line[16 * AXES];
int length = 0;
unsigned long received_ms = 0;
bool detached = true;

void turn() {
  for (int axis = 0; axis < AXES; axis++) {
    if (detached) servos[axis].attach(PINS[axis]);
    servos[axis].writeMicroseconds(CENTRE_US + angles[axis] * US_PER_RAD / 1000000L);
  }
  detached = false;
}

// A servo without pulses holds its angle.
void halt() {
  for (int axis = 0; axis < AXES; axis++) servos[axis].detach();
  detached = true;
}

// Applies all angles of a line, or none of them if one is invalid.
bool set(char *text) {
  long targets[AXES];
  for (int axis = 0; axis < AXES; axis++) {
    char *end;
    targets[axis] = strtol(text, &end, 10);
    if (end == text || targets[axis] < MIN_URAD || targets[axis] > MAX_URAD) return false;
    text = end;
  }
  while (*text == ' ' || *text == '\r') text++;
  if (*text != 0) return false;
  memcpy(angles, targets, sizeof(angles));
  turn();
  return true;
}

void handle_line() {
  if (strncmp(line, "hello", 5) == 0) {
    Serial.print("heliostat 1 "); Serial.print(MIRRORS);
    Serial.print(' '); Serial.print(MIN_URAD);
    Serial.print(' '); Serial.print(MAX_URAD); Serial.println(" 0");
  } else if (strncmp(line, "set ", 4) == 0) {
    Serial.println(set(line + 4) ? "ok" : "error the angles are not 8 numbers within the limits");
  } else if (strncmp(line, "stop", 4) == 0) {
    halt();
    Serial.println("ok");
  } else {
    Serial.println("error unknown line");
  }
}

void setup() { Serial.begin(115200); }

void loop() {
  while (Serial.available()) {
    char next = Serial.read();
    if (next == '\n') {
      line[length] = 0;
      received_ms = millis();
      handle_line();
      length = 0;
    } else if (length < (int)sizeof(line) - 1) {
      line[length++] = next;
    }
  }
  if (!detached && millis() - received_ms > SILENCE_MS) halt();
}
