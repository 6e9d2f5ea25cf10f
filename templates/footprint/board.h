/* What a program on the emulated board may call. */
#ifndef BOARD_H
#define BOARD_H

void board_write(const char *text);
void board_write_number(unsigned int value);
unsigned int board_ticks(void); /* counts up at 25 MHz, 24 bits */

#endif
