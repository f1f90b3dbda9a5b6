// SPDX-License-Identifier: MIT OR GPL-2.0
/*
 * I2C devices with an interrupt, for the tests of the kernel's drivers: an adapter that is plugged in over USB/IP has
 * no wire for one. A timer raises the interrupt of every device ten times a second; the drivers then ask their chips
 * what there is.
 *
 *   echo "0 mpu6050 0x68" > /sys/module/i2c_interrupt/parameters/device    (adapter, name, address)
 */
#include <linux/hrtimer.h>
#include <linux/i2c.h>
#include <linux/irq.h>
#include <linux/irqdesc.h>
#include <linux/module.h>

#define DEVICES 8
#define PERIOD_NS (NSEC_PER_SEC / 10)

static struct i2c_client *clients[DEVICES];
static int irqs[DEVICES];
static int count;
static struct hrtimer timer;

static enum hrtimer_restart raise_interrupts(struct hrtimer *expired)
{
	int index, ready = smp_load_acquire(&count);

	for (index = 0; index < ready; index++)
		generic_handle_irq(irqs[index]);
	hrtimer_forward_now(expired, ns_to_ktime(PERIOD_NS));
	return HRTIMER_RESTART;
}

static int add_device(const char *text, const struct kernel_param *param)
{
	struct i2c_board_info info = { };
	struct i2c_adapter *adapter;
	struct i2c_client *client;
	unsigned short address;
	int number, irq;

	if (sscanf(text, "%d %19s %hx", &number, info.type, &address) != 3)
		return -EINVAL;
	if (count == DEVICES)
		return -ENOSPC;
	adapter = i2c_get_adapter(number);
	if (!adapter)
		return -ENODEV;
	irq = irq_alloc_desc(0);
	if (irq < 0) {
		i2c_put_adapter(adapter);
		return irq;
	}
	irq_set_chip_and_handler(irq, &dummy_irq_chip, handle_simple_irq);
	irq_modify_status(irq, IRQ_NOREQUEST, IRQ_NOPROBE);
	irqd_set_trigger_type(irq_get_irq_data(irq), IRQ_TYPE_EDGE_RISING);
	info.addr = address;
	info.irq = irq;
	client = i2c_new_client_device(adapter, &info);
	i2c_put_adapter(adapter);
	if (IS_ERR(client)) {
		irq_free_desc(irq);
		return PTR_ERR(client);
	}
	clients[count] = client;
	irqs[count] = irq;
	smp_store_release(&count, count + 1);
	return 0;
}

static const struct kernel_param_ops device_ops = { .set = add_device };
module_param_cb(device, &device_ops, NULL, 0200);
MODULE_PARM_DESC(device, "adapter, name and address of a device to add");

static int __init start(void)
{
	hrtimer_init(&timer, CLOCK_MONOTONIC, HRTIMER_MODE_REL_HARD);
	timer.function = raise_interrupts;
	hrtimer_start(&timer, ns_to_ktime(PERIOD_NS), HRTIMER_MODE_REL_HARD);
	return 0;
}

static void __exit stop(void)
{
	hrtimer_cancel(&timer);
	while (count > 0) {
		count--;
		i2c_unregister_device(clients[count]);
		irq_free_desc(irqs[count]);
	}
}

module_init(start);
module_exit(stop);
MODULE_LICENSE("Dual MIT/GPL");
MODULE_DESCRIPTION("I2C devices whose interrupt is a timer");
